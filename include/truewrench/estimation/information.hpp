// Information of all rows of a fit: what stretches and logs add, each log and the quarters of all (10.11).
#pragma once

#include "truewrench/estimation/fit.hpp"

#include <vector>

namespace truewrench {

inline bool Fit::linearise() {
  struct Share {
    Information all;
    std::vector<int> breaks;  // blocks after which a quarter ends
    std::vector<Information> to_break;
  };
  std::vector<std::vector<Share>> shares(logs_.size());
  for (std::size_t l = 0; l < logs_.size(); ++l) shares[l].resize(logs_[l].stretches.size());
  each_stretch([&](std::size_t l, Stretch& s, Sweep& sweep) {
    Share& share = shares[l][static_cast<std::size_t>(&s - logs_[l].stretches.data())];
    share.breaks = breaks(logs_[l], s);
    share.all = sweep.forward(s, layout_.log(l), local(l), lagged, logs_[l].sizes, Sweep::Extent::whole,
                              share.breaks, &share.to_break);
  });
  const Eigen::Index nt = layout_.size();
  const Information nothing{Eigen::MatrixXd::Zero(nt, nt), Eigen::VectorXd::Zero(nt)};
  Information all = nothing;
  quarters_.fill(nothing);
  logdet_x_ = 0.0;
  of_log_.assign(logs_.size(), {});
  for (std::size_t l = 0; l < logs_.size(); ++l) {
    const std::vector<int>& at = layout_.log(l).global;
    const auto own = static_cast<Eigen::Index>(at.size());
    of_log_[l] = {Eigen::MatrixXd::Zero(own, own), Eigen::VectorXd::Zero(own)};
    const auto add = [&at](Information& to, const Information& part, double times) {
      for (std::size_t i = 0; i < at.size(); ++i) {
        to.g[at[i]] += times * part.g[static_cast<Eigen::Index>(i)];
        for (std::size_t j = 0; j < at.size(); ++j)
          to.S(at[i], at[j]) += times * part.S(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
      }
    };
    for (std::size_t i = 0; i < shares[l].size(); ++i) {
      const Share& share = shares[l][i];
      if (!std::isfinite(share.all.logdet)) {
        failed = true;
        return false;
      }
      logdet_x_ += share.all.logdet;
      add(all, share.all, 1.0);
      of_log_[l].S += share.all.S;
      of_log_[l].g += share.all.g;
      const Stretch& s = logs_[l].stretches[i];
      const auto quarter = [&](int block) -> Information& {
        return quarters_[quarter_of(logs_[l], s, block)];
      };
      add(quarter(static_cast<int>(s.spline.blocks()) - 1), share.all, 1.0);
      for (std::size_t k = 0; k < share.to_break.size(); ++k) {
        add(quarter(share.breaks[k]), share.to_break[k], 1.0);
        add(quarter(share.breaks[k] + 1), share.to_break[k], -1.0);
      }
    }
  }
  data_ = all.S;
  gradient_ = all.g;
  return true;
}

}  // namespace truewrench
