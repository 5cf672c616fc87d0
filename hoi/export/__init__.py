"""What a run becomes for other programs, each from its record alone: `python -m hoi.export RUN.mcap`.

| file | for |
|---|---|
| `scene.glb`, `scene.usdc` | Blender, three.js, game engines: skinned person, moving object |
| `ply/`, `splat/`, `spz/` | splat viewers: all Gaussians, a file a frame |
| `smpl.npz`, `motion.bvh` | the person's motion |
| `video.mp4`, `video.gif`, `scene.html` | to look at |
| `trajectories.csv` | to plot |

Files are written whole or not at all.
"""
