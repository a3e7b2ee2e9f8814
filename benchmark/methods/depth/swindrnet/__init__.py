"""SwinDRNet: two fused Swin transformers predict depth and the confidence in the sensor."""
