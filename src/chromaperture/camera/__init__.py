"""A camera that measures photographs: the way from a picture to depth in millimetres."""
