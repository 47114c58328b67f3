"""Pictures in light and shade, in weather and by night."""
