"""The constitutive laws: each module in this folder is one, under its own name, by the `Law` that it calls LAW.

Reading them imports neither the kernel compiler nor torch nor scipy.
"""

import pkgutil
from importlib import import_module

from hoi.mpm.law import Law

_found = {module.name: import_module(f"{__name__}.{module.name}").LAW for module in pkgutil.iter_modules(__path__)}
LAWS: dict[str, Law] = dict(sorted(_found.items(), key=lambda item: (item[1].order, item[0])))
"""Name -> law, in the order in which they are listed."""
