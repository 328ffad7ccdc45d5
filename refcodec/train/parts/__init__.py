"""The parts of the method (refcodec.train.part.Part), which a training calls in turn."""
