#include "whole_record.hpp"

#include "truewrench/estimation/estimator.hpp"

namespace truewrench {

WholeRecord of_whole_record(const Statement& rig, const RecordedLog& log) {
  Settings settings;
  settings.discrepancy = 0.0;
  const Estimate map = Estimator(std::make_shared<const Statement>(rig), {&log}, settings).run();
  WholeRecord out;
  out.status = map.status;
  if (out.status != Status::ok) return out;
  out.gain = Eigen::Map<const RowMatrix>(map.fit->theta.data(), map.fit->channels(), 6);
  out.sigma = map.gain_covariance.diagonal().cwiseSqrt();
  return out;
}

}  // namespace truewrench
