#include "app.h"
#include "port.h"

static app_t app;

int main(void)
{
    const board_t *board = board_init();
    app_init(&app, board);
    for (;;) {
        app_step(&app);
        board->sleep(board->context);
    }
}
