"""One module for each family of mechanisms, with a function `make(number, rng)`."""
