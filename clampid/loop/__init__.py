"""The product's loop: add, undo, go on by itself, and the two worked examples of it."""
