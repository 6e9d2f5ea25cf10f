/* Start-up of an emulated Cortex-M board: vectors, floating-point unit, data; text and exit code by semihosting. */
#include "board.h"

extern unsigned int stack_top[];
extern unsigned int data_source[];
extern unsigned int data_start[];
extern unsigned int data_end[];
extern unsigned int bss_start[];
extern unsigned int bss_end[];

int main(void);
void reset(void);
static void fault(void);

typedef void (*vector_t)(void);

__attribute__((section(".vectors"), used)) static const vector_t vectors[16] = {
    (vector_t)(void *)stack_top, reset, fault, fault, fault, fault, fault, 0, 0, 0, 0, fault, fault, 0, fault, fault
};

static int semihosted(int operation, const void *argument)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

void board_write(const char *text)
{
    (void)semihosted(0x04, text); /* SYS_WRITE0 */
}

void board_write_number(unsigned int value)
{
    char text[12];
    char *at = &text[11];
    *at = '\0';
    do {
        --at;
        *at = (char)('0' + (char)(value % 10u));
        value /= 10u;
    } while (value != 0u);
    board_write(at);
}

static void leave(int code)
{
    /* SYS_EXIT: ADP_Stopped_ApplicationExit is success, ADP_Stopped_InternalError is not. */
    (void)semihosted(0x18, (code == 0) ? (const void *)0x20026 : (const void *)0x20024);
    for (;;) {
    }
}

static void fault(void)
{
    board_write("fault\n");
    leave(1);
}

void reset(void)
{
    unsigned int *from = data_source;
    unsigned int *to;
    *(volatile unsigned int *)0xE000ED88u |= 0xFu << 20; /* CPACR: full access to the floating-point unit */
    __asm__ volatile("dsb\n isb" ::: "memory");
    for (to = data_start; to < data_end; ++to) {
        *to = *from++;
    }
    for (to = bss_start; to < bss_end; ++to) {
        *to = 0u;
    }
    *(volatile unsigned int *)0xE000E014u = 0xFFFFFFu; /* SysTick: reload, value, on with the processor's clock */
    *(volatile unsigned int *)0xE000E018u = 0u;
    *(volatile unsigned int *)0xE000E010u = 5u;
    leave(main());
}

unsigned int board_ticks(void)
{
    return 0xFFFFFFu - *(volatile unsigned int *)0xE000E018u;
}
