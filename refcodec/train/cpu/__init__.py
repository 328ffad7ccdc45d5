"""Kernels for CPUs, compiled by numba. Each is tested against the definition in torch that it replaces."""
