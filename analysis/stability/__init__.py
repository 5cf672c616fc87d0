"""How the object's MPM stands up to extreme cases: a grid of them, a verdict on each, and a map.

`cases` is the grid, `trial` runs one case to an `outcome`, `verdict` judges it, `workers` runs many,
`chart` draws the map.
"""
