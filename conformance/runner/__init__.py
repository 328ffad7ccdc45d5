"""The runner: runs a decoder on the vectors in bounded time and memory, and judges its answers."""
