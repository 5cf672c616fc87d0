"""A run that is made while it is looked at: what is wanted changes, and only the last wish counts."""

import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from hoi.config import Config
from hoi.config.compose import composed, config_of, one_line
from hoi.config.validate import AUTO, LIMB_KEYS, to_config
from hoi.data import Run
from hoi.errors import InputError, RunError
from hoi.plan import make_plan
from hoi.reports import Advance, Bar
from hoi.runner.jobs import rehearse
from hoi.runner.shelf import Shelf

PATIENCE = 0.4
"""A wish that has not changed for so long is begun [s]."""
OWN = "the object's own"
"""Stands for the material that the object names."""


@dataclass(frozen=True)
class Wish:
    """What is wanted of a scene, beside what the command line said."""

    sentence: str
    object: str
    material: str
    """A name in conf/material, or `OWN`."""
    seed: int
    pull: float | None
    """lambda_attr [-]; None: what the config says, which may have none."""
    place: tuple[float, float]
    """x and y of the object [m]."""

    def choices(self) -> list[str]:
        """As on the command line, but for the sentence."""
        chosen = [f"object={self.object}", f"seed={self.seed}"]
        chosen += [f"material={self.material}"] if self.material != OWN else []
        chosen += [f"stage.attraction.lambda_attr={self.pull:g}"] if self.pull is not None else []
        return chosen

    def config(self, base: Sequence[str]) -> Config:
        """The config of this wish over the command line's.

        Raises:
            InputError: something that is not allowed.
        """
        try:
            values = composed(*base, *self.choices())
            if self.sentence != values.scene.motion_prompt:  # who knows which limb that is about
                values.scene.motion_prompt = self.sentence.replace("${", "\\${")  # no interpolation
                if not values.scene.striking_joints:
                    values.scene.update(dict.fromkeys(LIMB_KEYS, AUTO))
            position = values.scene.placement.position
            values.scene.placement.position = [round(self.place[0], 3), round(self.place[1], 3), position[2]]
        except (HydraException, OmegaConfBaseException) as error:
            raise InputError(one_line(error)) from error
        return to_config(values)


def first_wish(base: Sequence[str]) -> Wish:
    """What the command line asks for.

    Raises:
        InputError: something that is not allowed.
    """
    config = config_of(*base)
    thing = composed(*base, with_hydra=True).hydra.runtime.choices["object"]
    x, y, _ = config.scene.placement.position
    pull = getattr(config.stage.attraction, "lambda_attr", None)
    return Wish(config.scene.motion_prompt, thing, OWN, config.seed, pull, (x or 0.0, y or 0.0))


class Superseded(Exception):
    """Something else is wanted by now."""


class Rehearsal:
    """Makes what is wanted, one wish after the other, in a thread of its own.

    Args:
        base: the command line's overrides.
        shelf: where results of steps are found and kept.
        seen: told of a run with its motion, and again once the object has answered.
        said: told in a line how far it is, and what is wrong.
    """

    def __init__(
        self, base: Sequence[str], shelf: Shelf, seen: Callable[[Run], None], said: Callable[[str], None]
    ) -> None:
        self._base, self._shelf, self._seen, self._said = list(base), shelf, seen, said
        self._wish: Wish | None = None
        self._number = 0
        self._asked, self._ended = threading.Condition(), False
        self._thread = threading.Thread(target=self._work, daemon=True, name="rehearsal")
        self._thread.start()

    def want(self, wish: Wish) -> None:
        """From now on this, and nothing that was wanted before."""
        with self._asked:
            self._wish, self._number = wish, self._number + 1
            self._asked.notify_all()

    def stop(self) -> None:
        """End the thread, at the next iteration of what it does."""
        with self._asked:
            self._ended, self._number = True, self._number + 1
            self._asked.notify_all()
        self._thread.join()

    def _work(self) -> None:
        done = 0
        while number := self._settled(done):
            assert self._wish is not None
            try:
                self._make(self._wish, number)
            except Superseded:
                pass
            except (InputError, RunError) as error:
                self._said("; ".join(str(error).splitlines()))
            except Exception as error:  # a fault of ours, or no memory: the next wish is made all the same
                traceback.print_exc()
                self._said(f"{type(error).__name__}: {error}")
            done = number

    def _settled(self, done: int) -> int:
        """The number of a wish after `done`, once it has not changed for PATIENCE; 0 at the end."""
        with self._asked:
            self._asked.wait_for(lambda: self._ended or self._number > done)
            while not self._ended:
                number = self._number
                if not self._asked.wait_for(lambda number=number: self._ended or self._number > number, PATIENCE):
                    return number
            return 0

    def _make(self, wish: Wish, number: int) -> None:
        config = wish.config(self._base)
        for run in rehearse(config, make_plan(config), self._bar(number), self._shelf, [*self._base, *wish.choices()]):
            if self._number > number:
                raise Superseded
            self._seen(run)
            self._said(run.result["outcome"] or "the object's answer is on its way")

    def _bar(self, number: int) -> Bar:
        @contextmanager
        def bar(name: str, total: int) -> Iterator[Advance]:
            done = 0

            def advance(units: int = 1) -> None:
                nonlocal done
                if self._number > number:
                    raise Superseded
                done += units
                if done * 10 // total > (done - units) * 10 // total:
                    self._said(f"{name}, {done} of {total}")

            yield advance

        return bar
