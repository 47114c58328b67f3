"""What each detection is: of one vessel, a second box of it, one of its parts, or a merge of two vessels."""
