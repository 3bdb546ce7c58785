"""Routes round the obstacles of a map: search, shortening, and splines along them."""
