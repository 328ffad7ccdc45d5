"""The stages of the method (refcodec.train.stage.Stage), which a training run calls in turn."""
