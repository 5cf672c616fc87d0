"""The paper's method, a file a heading, in the paper's order:

| paper | file |
|---|---|
| Scene Representation | `scene_representation` |
| Agent Motion Synthesis: Object Motion Simulation | `object_motion` |
| Agent Motion Synthesis: Human Motion Score Distillation | `hmsd` |
| Physically-Aware Interaction Synthesis: Windowed Attraction Loss | `attraction` |
| In-Scene Variations (where the person starts) | `approach` |
| Contact Detection and Re-simulation | `contact`, `resimulation` |
| Video-SDS for Contact Fidelity | `video_sds` |
| Optimization (the three stages) | `optimization` |

What each stage can be replaced by is in `hoi.stages`; bodies, objects, solver, renderer and priors have rooms of their
own. Nothing here reads files, knows the command line or writes a record.
"""
