"""What command lines of servers for the browser share: where to listen, and listening until Ctrl-C."""

import argparse
import threading
import webbrowser
from collections.abc import Callable


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text}: allowed is 0 to 65535, 0 takes any that is free")
    return int(text)


def add_server_options(parser: argparse.ArgumentParser) -> None:
    """--port, --host and --open."""
    add = parser.add_argument
    add("--port", type=_port, default=8080, help="where to listen; 0 takes any that is free (default: %(default)s)")
    add("--host", default="127.0.0.1", help="0.0.0.0 lets other machines look, too (default: %(default)s)")
    add("--open", action="store_true", help="open the browser")


def serve(port: int, options: argparse.Namespace, stop: Callable[[], None]) -> int:
    """Says where it is, and waits for Ctrl-C; the exit code."""
    try:
        host = "localhost" if options.host in ("127.0.0.1", "0.0.0.0", "::") else options.host
        url = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
        print(f"{url}  (Ctrl-C ends it)", flush=True)
        if options.open:
            webbrowser.open(url)
        threading.Event().wait()
    except KeyboardInterrupt:
        stop()
    return 0
