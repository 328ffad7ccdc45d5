"""The package's own commands as processes: the demo, curves of rate and distortion, experiments."""
