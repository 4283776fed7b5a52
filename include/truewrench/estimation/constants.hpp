// The one table of constants of the estimator and its judgement (METHOD 10.9): value, unit, meaning, and the rate that each
// sets, or the word "tolerance". Python reads them.
#pragma once

#include <algorithm>
#include <cmath>

namespace truewrench::constants {

inline constexpr double knot_spacing =
    0.05;  // [s] coarsest h; finer where (10.7) asks: 20 Hz ripple NEES 0.9, 1.0 x bound
inline constexpr double periods_per_knot = 2.5;  // samples a knot at least, at the coarsest h
inline constexpr double halving_cost = 6.0;  // added to (10.7) a halving: never fired in 88 disturbed records
inline constexpr double pilot =
    5.0;  // [s] on which finer knots are tried first, of records twice as long: RMS of 200 disturbed ones as without it
inline constexpr double masked_told = 0.01;  // share of the samples that, masked, calls for finer knots
inline constexpr double gather_window =
    0.02;  // [s] of four rows, where it holds eight samples: gains at 1 kHz moved by 0.00 sigma, up to 40 Hz; a mask has one each side
inline constexpr double jacobian_spread =
    1e-3;  // of the motion's information in an interval, that a shared Jacobian may leave out: of 168 clean records of wrench motions and
           // tumbling wrong 2 -> 0, NEES 1.32 -> 0.99; 0.01 left 1
inline constexpr double smoothness_start = 1e3;  // q, SI: tolerance
inline constexpr double smoothness_least =
    1e-9;  // q's, by the rows of R against a sample's own: what rests keeps its information to 0.3 %, rounding loses 2e-7 of it; with
           // 1e-12 18 of 40 clean IMU records of one turning axis could not be factored
inline constexpr double freedom = 4.0;          // of the Student-t weights: 1 % of spikes at NEES 1.03
inline constexpr double mask_weight = 0.3;      // share of clean samples masked: 0.0003 of six channels
inline constexpr double mask_shortest = 0.030;  // [s] of a contact, which is widened; shorter gaps are closed
inline constexpr double mask_worth =
    1.2;  // factor on the variance of the noise found, up to which masked samples are left in: of motions that stop and go NEES
// 1.11 -> 0.99, worst of 50 4.4 -> 1.6; contacts and spikes have 1.26 and more, 224 disturbed records ended as before;
// on the size of d: drifts have at most 1.19, walks, steps and cables that lose a fifth 1.55 and more
inline constexpr double most_lost =
    0.2;  // share of the samples that are masked, or of the raw output that no motion explains, beyond which a result is
// refused: 9 of 476 imperfect records; explained by none at most 0.05 in 150 of them, with a foreign motion 0.26 to 1
inline constexpr double filter_prior = 0.5;  // 1 sigma of kappa and gamma
inline constexpr double undetermined =
    0.5;  // of the prior's sigma, from which on nothing was told: words (METHOD 6); kappa and gamma are held: NEES 27 -> 1.1
inline constexpr double delay_left =
    0.05;  // share of a delay that the gain leaves, below which it is held: 0.036 at most in the paper's motion, 0.1 elsewhere
inline constexpr double fewest_freedom = 3.0;  // left to a factor on noise, below which it is held: tolerance
inline constexpr double size_floor = 0.02;     // of a factor on noise, and of delta in sigma: tolerance
inline constexpr double departure_start = 0.1;   // upsilon and alpha, fraction of range: tolerance
inline constexpr double departure_floor = 1e-4;  // likewise: tolerance
inline constexpr double move =
    0.05;  // converged: of sigma of theta (RMS), and of the sizes as standard deviations; the step of differences in kappa and in
// the smoothness: tolerance
inline constexpr double robust_move = 0.25;        // of sigma of theta, where another fit begins: tolerance
inline constexpr int most_iterations = 25;         // tolerance
inline constexpr double taus[] = {0.1, 0.3, 1.0};  // [s] of (10.9): d entered in 1 of 8 clean records
inline constexpr double discrepancy_cap =
    3.0;  // sigma of the fit without d: without it d explains the wrench itself
inline constexpr double discrepancy_power = 1.5;  // of (10.6): tolerance
inline constexpr double doubt =
    1e-3;  // p of the scan (10.8), and of the two comparisons (10.11) together: clean records refused 0 of 104
inline constexpr double scan_longest = 30.0;  // [s]
inline constexpr double noise_told =
    2.0;  // factor on the stated sigma that is told, and beyond which one robust step is not enough
inline constexpr double motion_noise_most =
    10.0;  // factor on the motion's stated sigma, beyond which `online` alone is not sound: of 54 records with 0.1 to 2 % of the
           // velocities 1 to 5 m/s off none is; of 128 imperfect ones 1 that is usable (jitter)

}  // namespace truewrench::constants

namespace truewrench {

// w_t of METHOD 10.3 for the chi^2 of so many channels, and the chi^2 from which on it masks.
constexpr double robust_weight(int channels, double chi2) {
  return (constants::freedom + channels) / (constants::freedom + chi2);
}
// What it adds to -2 log L in place of chi^2.
inline double robust_sum(int channels, double chi2) {
  return (constants::freedom + channels) * std::log1p(chi2 / constants::freedom);
}
// From how much information of the data alone a parameter is told.
constexpr double told(double prior) {
  return 1.0 / (constants::undetermined * prior * constants::undetermined * prior);
}
// h of (10.2) at its coarsest, for this period of the motion [s].
constexpr double coarsest_spacing(double period) {
  return std::max(constants::knot_spacing, constants::periods_per_knot * period);
}
constexpr double masked_chi2(int channels) {
  return (constants::freedom + channels) / constants::mask_weight - constants::freedom;
}

}  // namespace truewrench
