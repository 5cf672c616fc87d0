"""What raters are asked, in the paper's order."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Question:
    key: str
    """As the table's column: "Q1" to "Q4"."""
    title: str
    text: str


QUESTIONS = (
    Question("Q1", "Physical plausibility", "How physically plausible is the object's response?"),
    Question("Q2", "Contact quality", "How accurate and realistic is the interaction?"),
    Question("Q3", "Motion naturalness", "How natural is the person's motion?"),
    Question("Q4", "Photorealism", "How much does it look like a real video?"),
)
SCALE = (1, 2, 3, 4, 5)
"""Worst to best."""
COLUMNS = ("study", "rater", "position", "video", *(question.key for question in QUESTIONS))
"""Of a file of answers, one row a video: which study, who, as how manyth, which video, and the ratings."""
CODE = r"[A-Za-z0-9_\-]{1,32}"
"""What a rater may be called."""
