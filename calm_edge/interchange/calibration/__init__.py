"""Camera calibrations of other programs: one module per format, the table in `formats`."""
