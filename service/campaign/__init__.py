"""The automated experiment: which tones, how large, how long, and the rig that is moved for them."""
