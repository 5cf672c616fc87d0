"""Error against run time of the object's physics, on problems with known answers and on benchmark scenes."""
