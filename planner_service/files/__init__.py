"""Files in and out: read within caps, written whole or not at all, and kept between processes."""
