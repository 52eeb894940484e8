"""The model of an object: its joints, with the surfaces of what moves and of what rests."""
