"""Person and object do not touch (paper, w/o Contact)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from hoi.stages.contract import ContactModel, Draft, option

if TYPE_CHECKING:
    from hoi.config import Config


@option("stage/contact", "none")
@dataclass
class NoContact(ContactModel):
    """None looked for: the object keeps its free motion."""

    stands_for: ClassVar[dict[str, str]] = {"no_contact": "the contact"}

    def plan(self, config: Config, draft: Draft) -> None:
        draft.without.append("no_contact")
        draft.omit("contact", "stage/contact is none", "detection, impulse and re-simulation")
