"""The certificate of a path: a dense recheck with the full model, for every friction state.

docs/certificate.md says what is proven, what is measured and what is allowed for.
"""
