"""The baseline that needs no weights: kinematic replay.

    python -m analysis.baseline scene=kick_soccer_ball seed=0 [render=video] [--clips DIR]
    python -m analysis.baseline --multirun 'scene=glob(*)' seed=0,1

The motion-capture clip whose caption is nearest to the motion prompt, on our body, placed such that the strike's peak
ends at the object; the object moves freely in closed form until it is touched, then on with the velocity of what
touched it. Nothing is optimised, nothing simulated. The other arguments are `hoi.run`'s; the record is one like its.

Exit codes: 0 done; 2 bad input; 3 the run itself failed; 130 interrupted.
"""
