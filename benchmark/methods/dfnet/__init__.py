"""DFNet: a small U-Net of dense blocks that see the sensor's depth at every resolution."""
