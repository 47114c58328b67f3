"""Good inputs with something wrong in them, each made from a number, and what readers do with them."""
