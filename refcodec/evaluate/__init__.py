"""What a file shows of photographs: image quality, bytes, seconds."""
