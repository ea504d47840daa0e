"""How functions of the control process are compiled, and where the result is kept: numba, and nothing of ours."""
