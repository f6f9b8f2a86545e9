"""The numbers of a picture, and the picture from them."""
