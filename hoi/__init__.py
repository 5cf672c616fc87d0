"""hoi: physically-aware 4D human-object interaction from a sentence and two Gaussian clouds."""

import os

__version__ = "0.1.0"

# Read by OpenMP when torch is imported: a thread that waits sleeps. Beside another busy program spinning takes ten
# times as long.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
