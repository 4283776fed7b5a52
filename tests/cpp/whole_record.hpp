// `map` beside the estimator of a control loop, in a translation unit of its own: both at once take a compiler 1.4 GB.
#pragma once

#include "truewrench/model/record.hpp"

namespace truewrench {

struct WholeRecord {
  Status status = Status::not_configured;
  Eigen::MatrixXd gain;   // (n, 6)
  Eigen::VectorXd sigma;  // (6 n)
};

// Without a discrepancy.
WholeRecord of_whole_record(const Statement& rig, const RecordedLog& log);

}  // namespace truewrench
