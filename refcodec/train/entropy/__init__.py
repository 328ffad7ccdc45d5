"""The entropy model in training (SPEC.md chapter 7): planes, F_h, SARM and CARM in float32, in the codec's units."""
