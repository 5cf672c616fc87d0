"""Stage 3: the contact looks right (paper, Video-SDS for Contact Fidelity). `hoi.method.refine_stage` walks it.

What reads records imports `hoi.refine.fidelity` alone, which needs no torch: so nothing is imported here.
"""
