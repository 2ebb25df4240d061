"""The compiled road: Numba kernels over Embree. They take packed arrays (see `engine/pack`) and check nothing."""
