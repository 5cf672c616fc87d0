"""Gradients through the object: the MPM's own steps backwards (`backwards`), and free flight (`flight`).

A run imports none of it.
"""
