"""The object's physics: an explicit MLS-MPM for elastic solids.

`materials`, `stability` and `state` are NumPy alone, so a plan can check a run without Taichi; `solver.simulate`
runs it.
"""

import os

# Read by Taichi when it is imported: no banner, no look for a newer version on the network.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "False")
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
