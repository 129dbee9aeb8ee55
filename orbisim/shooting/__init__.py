"""Multiple shooting: free runs over windows of recordings, and fits of hypotheses to them.

Knows effects with their values and declared parameters, and decides nothing between them.
"""
