"""The stages of the method (refcodec.train.part.Part), which a training calls in turn."""
