"""The observation language, and OBS."""
