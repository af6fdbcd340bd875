"""The catalogue of effects that a twin can lack, one small file each."""
