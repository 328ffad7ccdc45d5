"""The runner: a decoder's commands on the vectors, in bounded time and memory, judged."""
