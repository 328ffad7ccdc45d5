"""The rate model (SPEC.md chapter 7): planes, F_h, SARM and CARM in float32, in units of the codec."""
