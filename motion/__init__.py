"""The mathematics both processes share: plain leaf functions that numba compiles and numpy broadcasts."""
