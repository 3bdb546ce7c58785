"""ImageNet's photographs by colour, in [0, 1]: what published towers have learnt with."""

PIXEL_MEAN = (0.485, 0.456, 0.406)
PIXEL_SPREAD = (0.229, 0.224, 0.225)
