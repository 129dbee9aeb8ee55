"""The functions of the paper's equation RSSM, one module each."""
