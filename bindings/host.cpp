// Whether this machine runs code for x86-64-v3: the build asks, where it makes one core for its own machine.
#include "cpu.hpp"

int main() { return truewrench::supports_x86_64_v3() ? 0 : 1; }
