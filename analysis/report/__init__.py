"""One HTML page of a folder of runs, all inside: tables, pictures, videos, plans, times. Without torch or taichi."""
