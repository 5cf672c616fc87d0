"""hoi: physically-aware 4D human-object interaction from a sentence and two Gaussian clouds."""

import os

__version__ = "0.2.0"

# Read by Taichi when it is imported: no banner, no look for a newer version on the network.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "False")
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
# Read by OpenMP when torch is imported: a thread that waits sleeps. Beside another busy program spinning takes ten
# times as long.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
