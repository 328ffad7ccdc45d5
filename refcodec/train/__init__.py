"""What learns a scene from photographs: reading them, with their cameras and points."""
