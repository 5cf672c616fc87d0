"""A scene that answers while it is being set up, in the browser: `python -m hoi.live`, `hoi view --live`."""
