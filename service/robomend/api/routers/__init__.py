"""One file a resource. Routers translate and delegate; the work is done elsewhere."""
