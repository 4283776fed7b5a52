// Cross-product matrices, and the shift of a twist from one point of a rigid body to another.
#pragma once

#include "truewrench/types.hpp"

namespace truewrench {

// [x] with [x] y = x cross y.
inline Matrix3 cross_matrix(const Vector3& x) {
  Matrix3 m = Matrix3::Zero();
  m(2, 1) = x[0], m(1, 2) = -x[0];
  m(0, 2) = x[1], m(2, 0) = -x[1];
  m(1, 0) = x[2], m(0, 1) = -x[2];
  return m;
}

// 6 x 6 map from the twist of a point P to the twist of a point Q of the same rigid body, both in body
// axes: v_Q = v_P + Omega x r, with r from P to Q. The same constant matrix maps the component-wise
// derivatives, because r is fixed in the body.
inline Matrix6 twist_shift(const Vector3& r) {
  Matrix6 x = Matrix6::Identity();
  x.topRightCorner<3, 3>() = -cross_matrix(r);
  return x;
}

}  // namespace truewrench
