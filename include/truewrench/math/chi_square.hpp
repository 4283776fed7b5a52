// Upper tail of chi-square.
#pragma once

#include <cmath>
#include <limits>

namespace truewrench {

// log P(chi^2_freedom > x): the regularised upper incomplete gamma function by its series or its continued fraction (Lentz).
inline double chi_square_log_tail(double x, double freedom) {
  const double a = 0.5 * freedom, z = 0.5 * x;
  if (!(x > 0.0)) return 0.0;
  if (!std::isfinite(x)) return -std::numeric_limits<double>::infinity();
  const double front = -z + a * std::log(z) - std::lgamma(a);
  if (z < a + 1.0) {
    double term = 1.0 / a, sum = term;
    for (int k = 1; k < 10000 && term > 1e-17 * sum; ++k) sum += term *= z / (a + k);
    return std::log1p(-std::exp(front + std::log(sum)));
  }
  double b = z + 1.0 - a, c = 1e300, d = 1.0 / b, h = d;
  for (int i = 1; i < 10000; ++i) {
    const double an = -i * (i - a);
    b += 2.0;
    d = 1.0 / (an * d + b);
    c = b + an / c;
    h *= d * c;
    if (std::abs(d * c - 1.0) < 1e-15) break;
  }
  return front + std::log(h);
}

}  // namespace truewrench
