"""What becomes of contributions: the pixel filter."""
