"""A comparison of training on a GPU with training on the CPU: see __main__."""
