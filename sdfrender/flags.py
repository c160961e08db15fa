"""What a hit or a footprint has to say about itself."""

from enum import IntFlag


class Flag(IntFlag):
    """Bits of the flags of a hit."""

    MISS = 1  #: nothing was hit
    HORIZON = 2  #: the pixel's footprint crosses the horizon of the tangent plane
    TIR = 4  #: total internal reflection
    CAUSTIC = 8  #: the beam's cross-section vanished on the way
    SEAM = 16  #: samples of several charts were interpolated, or some of the one chart were missing
    BAND = 32  #: outside the exact band
    EDGE = 64  #: the gradient's length is far from 1: an edge of the surface
    NONLINEAR = 128  #: the footprint differs from its neighbours'
    CLAMPED = 256  #: the texture look-up was clamped: to the finest or the last level, or to the greatest anisotropy
