"""The reference of a record's topics and attachments, made from `hoi.record` and `hoi.data`.

`python scripts/docs_record.py` prints the page, as Markdown.
"""

from collections.abc import Iterator
from typing import Any

from docs_config import cell, descriptions

import hoi.record
from hoi.data import Contact, ObjectTrajectory
from hoi.record.schemas import ATTACHMENTS, JSON_SCHEMAS, OBJECT_ARRAYS, PROTOBUF_SCHEMAS

OPENING = """\
# What a record holds

{docstring}

`python -m hoi.run` writes it, `hoi.record.read(path)` gives it back as `hoi.data.Run`, NumPy throughout; `joints`,
`posed_points`, `video` and `read_metadata` of the same module read a part. Foxglove and Rerun open the file as it is:
all encodings are theirs but that of `/object/state`, which describes itself. This page is made from
`hoi/record/schemas.py`.
"""
KNOWN = {
    "hoi.Contact": descriptions(Contact) | {"time": "t_c in scene time [s].", "joint_name": "Of j_c."},
    "hoi.ObjectState": {name: text.replace("(T, ", "(") for name, text in descriptions(ObjectTrajectory).items()},
    "hoi.Energy": {"time": "Scene time [s].", "phase": "What moved the object."},
    "hoi.Motion": {"time": "Scene time [s]."},
}
"""Fields that the schema names and `hoi.data` describes."""


def fields_of(topic: str) -> Iterator[tuple[str, str, str]]:
    """Name, type, description of a topic's fields."""
    if topic in JSON_SCHEMAS:
        schema = JSON_SCHEMAS[topic]
        for name, field in schema["properties"].items():
            what = KNOWN[schema["title"]].get(name) or str(field.get("description", ""))
            yield name, field["type"], what
        return
    descriptor: Any = PROTOBUF_SCHEMAS[topic].DESCRIPTOR
    for field in descriptor.fields:
        kind = field.message_type.full_name if field.message_type else field_type(field)
        what = KNOWN.get(descriptor.full_name, {}).get(field.name, "")
        yield field.name, f"{kind}, repeated" if field.is_repeated else kind, what


def field_type(field: Any) -> str:
    """ "double", "string", ..., as a .proto file writes it."""
    names = {getattr(field, name): name for name in dir(field) if name.startswith("TYPE_")}
    return names[field.type].removeprefix("TYPE_").lower()


def title_of(topic: str) -> str:
    """The schema's name and encoding."""
    if topic in JSON_SCHEMAS:
        return f"`{JSON_SCHEMAS[topic]['title']}`, JSON"
    return f"`{PROTOBUF_SCHEMAS[topic].DESCRIPTOR.full_name}`, protobuf"


def page() -> str:
    """The page, as Markdown."""
    parts = [OPENING.format(docstring=hoi.record.__doc__), "## Topics"]
    for topic in sorted([*JSON_SCHEMAS, *PROTOBUF_SCHEMAS]):
        lines = ["| field | type | |", "|---|---|---|"]
        lines += [f"| `{name}` | {kind} | {cell(what)} |" for name, kind, what in fields_of(topic)]
        parts += [f"### {topic}", title_of(topic), "\n".join(lines)]
    arrays = ", ".join(f"`{name}`" for name in OBJECT_ARRAYS)
    parts.append(
        f"The arrays of `/object/state` ({arrays}) are `hoi.Array`: `dtype` as NumPy writes it, `shape`, and `data` in "
        "C order, little-endian; the deformation gradient is absent where nothing simulates."
    )
    rows = [f"| `{name}` | {cell(what)} |" for name, what in ATTACHMENTS.items()]
    parts += ["## Attachments", "\n".join(["| file | what it holds |", "|---|---|", *rows])]
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    print(page(), end="")
