"""Methods as published: I to VI of Martos (2013), output error, filter error and SIDPAC's settings."""
