"""From where the arm stands to a detector position: approach, ways, and a move drawn up before it is made."""
