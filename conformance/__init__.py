"""Conformance of decoders: two more decoders, the suite and its runner, a fuzzer, and planted bugs."""
