"""What people look at: the timeline as SVG; the room of the page."""
