// A project that knows truewrench only as an installed package.
#include <truewrench/corrector.hpp>
#include <truewrench/ekf.hpp>

int main() {
  truewrench::Payload payload;
  payload.mass = 2.0;
  truewrench::Ekf<false> filter(payload, {});
  const truewrench::Vector6 zero = truewrench::Vector6::Zero();
  return filter.update(zero, zero, truewrench::Vector3::Zero()) == truewrench::Status::ok ? 0 : 1;
}
