"""Behaviour cloning of `task:stack`: what `tools/clone_stack.py` does, part by part."""
