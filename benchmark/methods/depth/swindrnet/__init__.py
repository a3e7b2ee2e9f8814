"""SwinDRNet: two Swin transformers, fused, restore depth and say how far to trust the sensor."""
