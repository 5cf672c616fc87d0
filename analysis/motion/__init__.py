"""How good a motion prior is, against real clips it has not seen: `python -m analysis.motion`."""
