"""The stages of the method (refcodec.train.stage.Stage), which a training calls in turn."""
