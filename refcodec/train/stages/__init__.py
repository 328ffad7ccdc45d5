"""The stages of the method (refcodec.train.stage.Stage): a module each, named as in settings.MODES."""
