"""The user study (the paper, Quantitative Evaluation): a page on which people rate videos, and the scores of it.

`make` collects the videos of recorded runs into a page that works from a file, `answers` reads what raters send back,
`agreement` says how far they agree, `score` makes the table. What the raters were asked stands in `questions`.
"""
