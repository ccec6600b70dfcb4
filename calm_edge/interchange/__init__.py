"""Files of other programs: formats that are read and written."""
