"""ISO 9283 characteristics and the certificate. (Its own part of the plan.)"""
