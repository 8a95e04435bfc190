"""An attack on the package: hostile arguments, mutated files, random robots, interrupts and kills, for hours."""
