"""What comes in and goes out over HTTP: one file for each kind of thing; base.py has what they share."""
