/* How a controller uses the model: correct a joint command for the load it carries. */
#include "kuka_kr270.h"

#include <stdio.h>

int main(void)
{
    const double q[KUKA_KR270_N_JOINTS] = {-2.645, -0.465, 1.346, -5.599, 2.103, 5.68};
    const double w[6] = {0.0, 0.0, -1000.0, 0.0, 0.0, 0.0}; /* N, N*m on the robot at the tool centre point, base axes */
    double dt[6];
    double q_cmd[KUKA_KR270_N_JOINTS];
    int i;
    int status;
    status = kuka_kr270_deflection(&kuka_kr270_default_params, q, w, dt);
    if (status != KUKA_KR270_OK) {
        printf("deflection: error %d\n", status);
        return 1;
    }
    printf("deflection [mm]: %.4f %.4f %.4f\n", (double)dt[0] * 1e3, (double)dt[1] * 1e3, (double)dt[2] * 1e3);
    status = kuka_kr270_compensate(&kuka_kr270_default_params, q, w, q_cmd);
    if (status != KUKA_KR270_OK) {
        printf("compensate: error %d, the command stays as it was\n", status);
    }
    for (i = 0; i < KUKA_KR270_N_JOINTS; ++i) {
        printf("q%d: %.6f -> %.6f\n", i + 1, (double)q[i], (double)q_cmd[i]);
    }
    return 0;
}
