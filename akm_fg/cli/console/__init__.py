"""What people read: lines that cannot break a terminal, on streams that take them."""
