"""Tables: columns of signals with labels and units, of text and of the binary files of loggers."""
