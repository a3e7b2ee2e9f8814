"""Labels of two people of one recording, compared."""
