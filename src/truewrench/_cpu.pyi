"""Processor features, for the choice of the compiled core."""



def supports_x86_64_v3() -> bool:
    """Whether code compiled for x86-64-v3 (AVX2, FMA) runs here."""
