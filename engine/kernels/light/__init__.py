"""Everything that emits, one file each, and how one of many is chosen (`tree`, `emitters`).

Each lamp has two functions: `sample_x` draws a direction towards it and `x_seen` tells what a ray that meets it
sees. Both end in the same pdf, per steradian, of drawing that direction.
"""
