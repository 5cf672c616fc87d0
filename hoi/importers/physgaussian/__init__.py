"""Scene files of PhysGaussian and DreamPhysics: reading them, and what they say in our terms."""
