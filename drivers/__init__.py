"""Device drivers: bytes in, readings out."""
