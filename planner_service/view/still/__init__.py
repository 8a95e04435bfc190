"""Still pictures, drawn without a display."""
