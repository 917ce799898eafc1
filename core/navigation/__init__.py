"""INS/GNSS: strapdown mechanisation, error-state Kalman filter, alignment."""
