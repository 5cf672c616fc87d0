"""Stage 3: the contact looks right (paper, Video-SDS for Contact Fidelity). `hoi.refine.stage` decides when.

What reads records imports `hoi.refine.fidelity` alone, which needs no torch: so nothing is imported here.
"""
