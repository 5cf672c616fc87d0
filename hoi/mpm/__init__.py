"""The object's physics: an explicit MLS-MPM for elastic solids.

`materials`, `stability` and `state` are NumPy alone, so a plan can check a run without Taichi; `solver.simulate`
runs it.
"""
