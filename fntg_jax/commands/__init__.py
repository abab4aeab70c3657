"""The commands of `fntg`, one module each, imported when called."""
