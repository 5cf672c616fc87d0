"""The object's physics: an explicit MLS-MPM for elastic solids.

`laws`, `materials`, `stability` and `state` are NumPy alone, so a plan can check a run without the compiler
of the kernels; `solver.simulate` runs it.
"""
