"""The simulated camera: renderers, noise, masks, calibration boards."""
