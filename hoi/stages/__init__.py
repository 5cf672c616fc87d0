"""The options of every stage, one file each: `hoi/stages/object/mpm.py` is what `stage/object=mpm` chooses.

An option is one dataclass (`hoi.stages.contract.Option`) that is its schema, its checks, its lines of the plan and,
with what it needs imported only then, its run. Its values stand in the file of the same place in `conf/`. A file in
here is found by being here.
"""

import pkgutil
from importlib import import_module

from hoi.stages.contract import OPTIONS, Option


def options() -> dict[tuple[str, str], type[Option]]:
    """(group, name) -> the option, of all: ("stage/object", "mpm"), ..."""
    for module in pkgutil.walk_packages(__path__, f"{__name__}."):
        import_module(module.name)
    return OPTIONS
