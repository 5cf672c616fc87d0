"""hoi: physically-aware 4D human-object interaction from a sentence and two Gaussian clouds."""

__version__ = "0.1.0"
