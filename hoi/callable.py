"""Modules that are functions as well: `hoi.run` and `hoi.render` are rooms, and what one does in them."""

import sys
from types import ModuleType


class CallableModule(ModuleType):
    """A module that is called as the function of the same name in `hoi.api`."""

    def __call__(self, *args, **kwargs):
        from hoi import api

        return getattr(api, self.__name__.rpartition(".")[2])(*args, **kwargs)


def called(module: str) -> None:
    """Makes the module of that name callable; `python -m` of it is not changed by this."""
    sys.modules[module].__class__ = CallableModule
