"""Box errors: their unit and law, how long they persist, and what each vessel keeps of them."""
