"""Questions without a robot: text in, result out, result as JSON; what-if."""
