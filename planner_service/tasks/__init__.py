"""Pick, place and straight tool moves, made of several motions."""
