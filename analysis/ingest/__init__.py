"""Outputs of other systems as records, so that they enter the same tables.

    python -m analysis.ingest --scene kick_soccer_ball --system 4D-fy --video out.mp4
    python -m analysis.ingest --scene kick_soccer_ball --system AnimateAnyMesh --person person.glb --object ball.glb

A video is all that the learned metrics need. Of animated meshes the record holds points of the person's skin, tracked
through all frames, and the object as particles of its surface and inside. See docs/baselines.md.
"""
